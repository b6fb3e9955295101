"""Plain Gaussians as the bytes of other programs' files; nothing here touches a disk."""
