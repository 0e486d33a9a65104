"""The blind proof: trials with injected effects, sealed, diagnosed, unsealed and scored."""
