"""Other codes' answers to the same questions; each optional."""
