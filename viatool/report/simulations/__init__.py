"""Reports on simulations: `viatool simulate`."""
