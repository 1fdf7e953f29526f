"""Where extended bodies may stand and move: tiles, sweeps, and the roadmap over them."""
