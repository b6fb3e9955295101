"""Other programs' files of Gaussians, read: each in a module of its own, `any` chooses."""
