"""Parts that several layouts of data sets share: image files, rows of poses, intrinsics, archives and videos."""
