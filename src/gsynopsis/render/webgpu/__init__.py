"""The rasterizer as WGSL kernels, on any GPU that wgpu-py reaches: Vulkan, Metal, DX12."""
