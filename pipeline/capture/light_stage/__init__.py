"""Light stages on disk: their folders whatever they are called, frames to lights, and what other rigs lack."""
