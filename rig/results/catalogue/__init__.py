"""What is known of recorded runs: lists, single runs, comparisons, trends and verification."""
