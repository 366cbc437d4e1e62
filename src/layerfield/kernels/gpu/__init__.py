"""Passes over memory on a GPU, written in Triton, which comes with PyTorch where there is CUDA.

Each of them does what a few dozen operations of PyTorch do, or a compiled loop on a processor. They
are imported where `serving.on_gpu` says that they serve; PyTorch's own operations are the plain
version beside them.
"""
