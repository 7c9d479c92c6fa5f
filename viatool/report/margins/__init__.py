"""Reports on margins: `viatool margin`."""
