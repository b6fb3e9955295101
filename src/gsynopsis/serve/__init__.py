"""A small static server with ranges, for a `.gsyn` file or a folder of them."""
