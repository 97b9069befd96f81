"""The terms that recipes are made of, and the gradient step that takes them."""
