"""The full frictional contact solve of an assembly, no reduction."""
