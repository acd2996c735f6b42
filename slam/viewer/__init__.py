"""The live view: what the pipeline is doing, in a browser or in Foxglove."""
