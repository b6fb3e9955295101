"""Training: quality, time, and what each part is worth."""
