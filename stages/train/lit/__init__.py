"""The trained Gaussians with the colours that leave them under the captured light: what viewers that know no material show."""
