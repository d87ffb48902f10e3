"""How kernels are compiled and kept. One decorator, `kernel`, for all of them:

    from pipeline.kernels.compiling import kernel

    @kernel(nogil=True, fastmath=True, error_model="numpy")  # numba.njit's options
    def scale(values, factor): ...

The rule of freshness: numba freezes into a kernel's machine code the constants that it reads and the kernels that it calls,
other files' too, but looks at the kernel's own file alone when it decides whether kept code is still right. Here kept code is
named after the digest of every project file that the kernel's file draws on: those that it imports, those that they import,
and so on (`freshness`). If any of them changes, the name changes and the kernel is compiled again; comments and docstrings do
not count, and code of equal sources is shared whatever checkout it came from. The same digest names the object files of
kernels that run without numba (`native`). What a process compiles after one of its sources was edited, it keeps to itself.

Freshly compiled or loaded, a kernel gives the same bits: it holds its own copies of what it calls (`linking`). One case is not
mended: with `parallel=True`, the light tree's gradient in the viewing direction still differs in its last bits between the
process that compiles it and those that load it; compiled without, it does not.

What Python calls and what kernels call is compiled apart. A kernel that another one calls is compiled as a twin, without the
wrapper that only Python needs, and gets no machine code of its own (`on_demand`): with many small kernels below each other, as
in the fits of the light stage, a third of the time went there. Tests may still call it: then it is compiled for Python too.

What the rule cannot see, so do not do it: constants read from data files, modules imported by a computed name, a module that
another one changes from outside. Two kernels of one file must not share a qualified name (`kernel` refuses the second).

Where code is kept (`storage`): in the folder NUMBA_CACHE_DIR if that is set, else in this package's `__pycache__`, else, where
that cannot be written, in the user's cache (XDG_CACHE_HOME or ~/.cache). Where nothing can be written, every process compiles
for itself. Code for which this checkout has no use is deleted when nobody used it for a day; in a folder that other checkouts
may share, for two weeks.

How to add a kernel: `docs/adding.md`.
"""
