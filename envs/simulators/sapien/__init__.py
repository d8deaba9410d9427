"""SAPIEN 3: PhysX on CPU, and its Vulkan renderer."""
