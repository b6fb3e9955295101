"""Readers of other programs' splat files, a module for each format; `any` chooses."""
