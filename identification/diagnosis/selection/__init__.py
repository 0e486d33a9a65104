"""Selection of effects: forward selection, comparison with rivals, removal, held-out test."""
