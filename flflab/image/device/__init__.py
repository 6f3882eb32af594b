"""Pictures on a CUDA device: the formulas of the processor's kernels, every pixel worked out by a
thread of its own.
"""
