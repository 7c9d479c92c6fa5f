"""Reports on visited states: `viatool verify`."""
