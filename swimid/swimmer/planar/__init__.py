"""Planar multi-link swimmers: a robot file's links, joints and elements as one simulated model."""
