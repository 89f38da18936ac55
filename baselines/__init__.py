"""Models of the STONE paper's Table II, in plain PyTorch: `stone train` and `stone predict` run them on our exports.

**Conventions.** `baselines/batch.py` says what a model is given, `baselines/models/occupancy_model.py` what it answers.
Layers and models know tensors only; files are met in `data.py`, `cache.py`, `checkpoint.py` and `predict.py`. Nothing
here is imported by the platform, which runs without torch.
"""
