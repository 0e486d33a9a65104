"""From a sequence and a bench to a plan: targets, limits, first pass, feed-forward, gas flow."""
