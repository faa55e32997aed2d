"""What layouts of data sets have in common: image files, rows of poses, intrinsics, archives and videos."""
