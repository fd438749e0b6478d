"""Looking at results: at a finished run, or at a sweep."""
