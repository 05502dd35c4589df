"""Multi-link robots in space: a tree of rigid bodies in water, on a base free to move and turn."""
