"""The console commands, one file each, with a function of the same name: thin covers over the package."""
