# slam in a container: docker build -t slam . ; docker run --rm slam --help
# On a robot, give it its ports and a folder to write to:
#   docker run --rm --device /dev/serial/by-id/... -v "$PWD:/data" -p 127.0.0.1:8321:8321 \
#     slam online --config robot.toml --out RUN --view-address 0.0.0.0
FROM debian:13-slim

# Python from Debian; libgomp1 and libstdc++6 are what the wheels of gtsam, numba and numpy link to.
RUN apt-get update \
    && apt-get install -y --no-install-recommends python3 python3-venv libgomp1 libstdc++6 \
    && rm -rf /var/lib/apt/lists/*

WORKDIR /src
COPY pyproject.toml requirements.lock README.md LICENSE ./
COPY slam slam
COPY drivers drivers
COPY frontend frontend
COPY backend backend
COPY logs logs
RUN python3 -m venv /opt/slam \
    && /opt/slam/bin/pip install --no-cache-dir -c requirements.lock '.[live]' \
    && rm -rf /src/build

# Serial ports belong to the group dialout; kernels are compiled into a folder that anybody may write.
RUN useradd --create-home --groups dialout slam && install -d -m 1777 /var/cache/slam
ENV NUMBA_CACHE_DIR=/var/cache/slam PATH=/opt/slam/bin:$PATH
USER slam
WORKDIR /data
ENTRYPOINT ["slam"]
CMD ["--help"]
