"""Which effects are missing: forward selection, comparison with rivals, removal, held-out test."""
