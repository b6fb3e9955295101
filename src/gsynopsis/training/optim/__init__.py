"""Adam, its parameter groups and schedules."""
