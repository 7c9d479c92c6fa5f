"""Reports on whether a specification is right: `viatool doctor`."""
