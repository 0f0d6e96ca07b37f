"""Policies for other runtimes.

``contract``: what they take and give; ``onnx``: as one graph; ``c``: as C99, whose text ``sources`` writes and whose
structs ``layout`` fills.
"""
