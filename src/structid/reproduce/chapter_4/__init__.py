"""Chapter 4: the perturbation technique."""
