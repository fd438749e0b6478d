"""Message passing in simulated time; knows nothing of pursuit and can be used without it."""
