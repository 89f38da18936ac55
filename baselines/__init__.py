"""Models of the STONE paper's Table II, in plain PyTorch, for `stone model train` and `stone model predict`.

**Conventions.** `baselines/batch.py` says what a model is given, `baselines/models/occupancy_model.py` what it answers.
Layers and models know tensors only; files are met in `data.py`, `cache.py`, `checkpoint.py` and `predict.py`. Nothing
here is imported by the platform, which runs without torch.
"""

import os

# The matrix tiles of newer Xeons (AMX) are left out: with them oneDNN of torch 2.13 answers bfloat16 convolutions of
# few input channels wrongly (pytorch issues 169688 and 163347). Read when oneDNN is first used, so before any model.
os.environ.setdefault("ONEDNN_MAX_CPU_ISA", "AVX512_CORE_BF16")
