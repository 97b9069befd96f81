"""How the kernels of the chase are compiled: kept on disk, divisions as NumPy's."""

import numba as nb

jit = nb.njit(cache=True, error_model="numpy")
part = nb.njit(cache=True, error_model="numpy", forceinline=True)  # of a kernel, never alone
