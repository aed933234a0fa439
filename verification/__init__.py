"""The judge: how far production results are from the truth, where, and what accuracy costs."""
