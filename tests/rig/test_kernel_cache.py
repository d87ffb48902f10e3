"""Compiled kernels: the light stage's lie in a folder named after their sources, everyone else's where numba puts them."""

from pipeline.kernels import cache as kernel_cache
from pipeline.kernels import numerics
from pipeline.shading import prefilter_kernels as kernels


def test_only_the_light_stages_kernels_are_kept_by_their_sources():
    own = next(v for v in vars(numerics).values() if hasattr(v, "_cache") and v._cache.cache_path)
    other = next(v for v in vars(kernels).values() if hasattr(v, "_cache") and v._cache.cache_path)
    if kernel_cache.folder() is not None:
        assert own._cache.cache_path.startswith(str(kernel_cache.folder()))
    assert "kernels-" not in other._cache.cache_path  # else any change of an olat kernel compiles the training's again
