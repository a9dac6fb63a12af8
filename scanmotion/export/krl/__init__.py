"""KUKA Robot Language."""
