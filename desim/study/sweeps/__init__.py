"""One sweep from its plan to its result: which runs are missing, when enough values are known, what is stored."""
