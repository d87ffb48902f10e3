"""A device of its own, held in the CPU's memory, with a GPU's manners: its tensors refuse to mix with the CPU's, and have no
numpy(). What runs on it has no tensor left behind on the wrong side; what it counts, a GPU would be waited for.

Import it before anything is made on the device, in a process of its own: torch knows one such device. Nothing that was made on
it is given back before the process ends, so it serves for a few steps of a small scene.
"""

from __future__ import annotations

import sys
from collections import Counter
from typing import Any

import torch
from torch.utils._pytree import tree_leaves, tree_map
from torch.utils.backend_registration import _setup_privateuseone_for_python_backend

NAME = "standin"
READS = ("aten::_local_scalar_dense", "aten::nonzero", "aten::masked_select", "aten::_unique2")  # wait for the device
INDEXING = ("aten::index", "aten::index_put_", "aten::index_put", "aten::_index_put_impl_")  # may take the CPU's indices
WRITTEN_HERE = ("_to_copy", "copy_", "_copy_from")
NOT_NEEDED = (
    "backward",
    "record_stream",
    "pin",
    "sparse",
    "set_",
    "resize",
    "storage",
    "empty",
    "quantize",
    "_foreach",
    "_fused",
)

waits: Counter[str] = Counter()  # by the place in our code: since `waits.clear()`
_held: dict[int, torch.Tensor] = {}  # by storage, which the copies that torch makes of a tensor for itself share


def is_held(value: Any) -> bool:
    return isinstance(value, torch.Tensor) and value.device.type == NAME


def held(tensor: torch.Tensor) -> torch.Tensor:
    """The CPU's tensor behind one of the device's."""
    return _held[tensor.untyped_storage()._cdata]


def put(tensor: torch.Tensor) -> torch.Tensor:
    """A tensor of the device over one of the CPU's."""
    made = torch._C._acc.create_empty_tensor(tuple(tensor.shape), tensor.dtype)
    _held[made.untyped_storage()._cdata] = tensor
    return made


def _waited() -> None:
    frame: Any = sys._getframe(1)
    while frame and (frame.f_code.co_filename == __file__ or "/torch/" in frame.f_code.co_filename):
        frame = frame.f_back
    waits[f"{frame.f_code.co_filename}:{frame.f_lineno}" if frame else "backward"] += 1


def _inner(value: Any, indices: bool) -> Any:
    """What an operator on the CPU is given instead of `value`."""
    if isinstance(value, torch.device):
        return torch.device("cpu") if value.type == NAME else value
    if not isinstance(value, torch.Tensor):
        return value
    if is_held(value):
        return held(value)
    if value.dim() and not (indices and not value.is_floating_point()):
        raise RuntimeError(f"a tensor of the CPU, {tuple(value.shape)}, among the device's")
    return value


def _run(op: Any, *args: Any, **kwargs: Any) -> Any:
    """Any operator, by the CPU's."""
    name = op._schema.name
    if name in READS:
        _waited()
    ours = {id(held(leaf)): leaf for leaf in tree_leaves((args, kwargs)) if is_held(leaf)}
    if name in ("aten::view", "aten::_unsafe_view"):  # what is held may lie otherwise in memory than what stands for it
        op = torch.ops.aten.reshape.default
    args, kwargs = tree_map(lambda leaf: _inner(leaf, name in INDEXING), (args, kwargs))
    out = op(*args, **kwargs)
    if name == "aten::_local_scalar_dense":
        return out
    return tree_map(lambda leaf: ours.get(id(leaf), put(leaf)) if isinstance(leaf, torch.Tensor) else leaf, out)


def _to_copy(source: torch.Tensor, *, dtype: Any = None, device: Any = None, **_: Any) -> torch.Tensor:
    target = device or source.device
    plain = held(source) if is_held(source) else source
    value = plain.to(dtype or plain.dtype, copy=True)
    if is_held(source) and target.type == "cpu":
        _waited()
    return put(value) if target.type == NAME else value


def _copy(target: torch.Tensor, source: torch.Tensor, non_blocking: bool = False) -> torch.Tensor:
    (held(target) if is_held(target) else target).copy_(held(source) if is_held(source) else source)
    return target


def _register() -> torch.library.Library:
    """Every operator that torch would otherwise put together out of others by strides, of which the device has none."""
    library = torch.library.Library("aten", "IMPL")
    has = torch._C._dispatch_has_kernel_for_dispatch_key
    for full in torch._C._dispatch_get_all_op_names():
        name = full.removeprefix("aten::")
        packet, _, overload = name.partition(".")
        composite = has(full, "CompositeExplicitAutograd") or has(full, "CompositeExplicitAutogradNonFunctional")
        needed = composite and not any(part in name for part in NOT_NEEDED) and packet not in WRITTEN_HERE
        allocates = name in ("empty.memory_format", "empty_strided", "empty_like", "view", "as_strided", "_reshape_alias")
        op = getattr(getattr(torch.ops.aten, packet, None), overload or "default", None)
        if full.startswith("aten::") and (needed or allocates) and op is not None:
            library.impl(name, lambda *args, _op=op, **kwargs: _run(_op, *args, **kwargs), "PrivateUse1")
    library.impl("_to_copy", _to_copy, "PrivateUse1")
    library.impl("copy_", _copy, "PrivateUse1")
    library.impl("_copy_from", lambda source, target, non_blocking=False: _copy(target, source), "PrivateUse1")
    return library


_setup_privateuseone_for_python_backend(NAME)
_rest = torch.library.Library("_", "IMPL")
_rest.fallback(_run, "PrivateUse1")
_aten = _register()
