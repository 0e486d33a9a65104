"""The blind proof: rigs with concealed physics, sealed, diagnosed, unsealed and scored."""
