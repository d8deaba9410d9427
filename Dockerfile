# CPU image:  docker build -t roboverse .
# CUDA image: docker build -t roboverse:cuda --build-arg TORCH_BACKEND=cu130 .   (run it with --gpus all)
ARG PYTHON_IMAGE=python:3.12.8-slim-bookworm
FROM ${PYTHON_IMAGE}

# uv takes PyTorch's wheels of this backend: cpu, or cu130 for an NVIDIA GPU.
ARG TORCH_BACKEND=cpu
ENV UV_TORCH_BACKEND=${TORCH_BACKEND} \
    UV_NO_CACHE=1 \
    PIP_NO_CACHE_DIR=1 \
    NVIDIA_DRIVER_CAPABILITIES=compute,utility,graphics \
    PATH=/home/roboverse/learn/.venv/bin:$PATH

RUN useradd --create-home --uid 1000 roboverse
USER roboverse
WORKDIR /home/roboverse/learn

COPY --chown=roboverse README.md LICENSE pyproject.toml constraints.txt overrides.txt ./
COPY --chown=roboverse configs configs
COPY --chown=roboverse envs envs
COPY --chown=roboverse policies policies
COPY --chown=roboverse benchmark benchmark
COPY --chown=roboverse results/tasks.json results/tasks.json
COPY --chown=roboverse roboverse_learn roboverse_learn

# The README's installation as it stands there.
RUN python3.12 -m venv .venv && .venv/bin/python -m pip install -q uv && .venv/bin/uv pip install -q --python .venv/bin/python -c constraints.txt --override overrides.txt -e . -e envs/lerobot/plugin -e envs/gymnasium_plugin

# Runs, datasets and results are written here; a volume mounted here keeps them.
RUN mkdir /home/roboverse/work
WORKDIR /home/roboverse/work
ENTRYPOINT ["roboverse"]
CMD ["train", "policy=act", "task=PickCube", "preset=quick"]
