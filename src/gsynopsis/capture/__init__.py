"""Photos or a video to poses and points (extra `sfm`)."""
