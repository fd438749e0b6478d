"""What the pictures of one run have in common: deliveries, handovers and headings, computed from its trace."""
