"""The dataset directory: content-addressed versions of each stage's output, published whole or not at all."""

from pipeline.engine.dataset.digests import DigestCache, digest_json
from pipeline.engine.dataset.directory import Dataset, Version

__all__ = ["Dataset", "DigestCache", "Version", "digest_json"]
