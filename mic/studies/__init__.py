"""Questions to a model beyond a run: what it hangs on, what drives it, how rare a miss is; one file a question."""
