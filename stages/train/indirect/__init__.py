"""Indirect light other than traced (`train.indirect`): PhyGaP's GridMap, and Ref-Gaussian's learnt spherical harmonics."""
