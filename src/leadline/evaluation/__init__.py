"""How good it was: accuracy against truth, detection metrics, summaries and pictures."""
