"""Where the model starts: the masks' visual hull, sampled with Gaussians."""
