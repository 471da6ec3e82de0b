"""The offline side: SERL training, and populations to ONNX. Meets the runtime only in files."""
