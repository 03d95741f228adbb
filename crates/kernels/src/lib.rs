//! Fused convolution kernels for the CPU and their burn operations.
