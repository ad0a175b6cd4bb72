"""What never changes: yardsticks for the speed of our kernels, and figures of former versions."""
