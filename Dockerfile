# polarfield in a container: `docker build -t polarfield .`, then
#   docker run --rm -v "$PWD/captures:/captures:ro" -v "$PWD/datasets:/datasets" polarfield all /captures/vase --dataset /datasets/vase
FROM python:3.11-slim-bookworm

RUN apt-get update \
    && apt-get install -y --no-install-recommends libegl1 libgl1 libx11-6 libusb-1.0-0 libatomic1 libgomp1 \
    && rm -rf /var/lib/apt/lists/*

WORKDIR /opt/polarfield
COPY pyproject.toml constraints.txt README.md LICENSE ./
COPY pipeline pipeline
COPY polarfield polarfield
COPY stages stages
COPY synth synth
COPY workflow workflow
RUN pip install --no-cache-dir --constraint constraints.txt .

# Kernels are compiled on first use and kept in the home folder: a volume there saves the minute.
ENV HOME=/home/polarfield
RUN useradd --create-home --uid 1000 polarfield && mkdir -p /datasets && chown polarfield /datasets
USER polarfield
WORKDIR /datasets
ENTRYPOINT ["polarfield"]
CMD ["--help"]
