"""A development server for a `.gsyn` file or a folder of them; nginx is for the internet."""
