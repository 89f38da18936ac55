"""Models of the STONE paper's Table II, in plain PyTorch, for `stone model train` and `stone model predict`.

**Conventions.** `baselines/batch.py` defines the inputs of models, `baselines/models/occupancy_model.py` their outputs.
Layers and models use tensors only; files are handled in `data.py`, `cache.py`, `checkpoint.py` and `predict.py`. The
platform, which runs without torch, imports nothing from here.
"""

import os

# AMX (matrix tiles of newer Xeons) is disabled: with it oneDNN of torch 2.13 computes wrong bfloat16 convolutions of
# few input channels (pytorch issues 169688 and 163347). The variable is set before any model, because oneDNN reads it
# at its first use.
os.environ.setdefault("ONEDNN_MAX_CPU_ISA", "AVX512_CORE_BF16")
