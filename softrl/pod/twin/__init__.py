"""The same steps in torch, for gradients."""
