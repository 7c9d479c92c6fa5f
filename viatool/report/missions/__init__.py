"""Reports on missions: `viatool mission`."""
