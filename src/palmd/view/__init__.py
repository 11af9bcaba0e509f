"""The live page: what a daemon publishes, brought into browsers, and their commands back. A process of its own."""
