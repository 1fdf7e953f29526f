"""The coordinator and its tools: everything that runs on the host."""
