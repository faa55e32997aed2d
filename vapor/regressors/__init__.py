"""Pose regressors: image -> samples of the posterior over camera poses; and the losses they are trained with."""
