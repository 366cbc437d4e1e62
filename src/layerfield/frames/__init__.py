"""Light field videos in: folders, sequences of files, and videos of quilts or atlases."""
