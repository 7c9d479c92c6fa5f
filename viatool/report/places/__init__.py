"""Reports on places: `viatool certify`."""
