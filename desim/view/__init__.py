"""Looking at a finished run."""
