"""The mapping algorithm: messages in, a pose graph out. No file, device, clock or thread."""
