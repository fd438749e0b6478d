"""Many runs: over grids and seeds, on one core or a cluster, kept in a store; and what they tell together."""
