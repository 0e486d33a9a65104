"""Output on recorded runs: lists, single runs, comparisons, trends and studies."""
