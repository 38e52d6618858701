# kinpole without an installation. Two images, both with the command `kinpole`:
#   docker build --target ros -t kinpole .       on ROS 2 Jazzy, x86-64 and aarch64
#   docker build --target python -t kinpole .    on plain Python, with rclpy as wheels, x86-64
# A node sees the ROS graph of its host with the network and the shared memory of it:
#   docker run --rm --init --net=host --ipc=host -v "$PWD:/data" kinpole \
#     node --ros-args --params-file rig.yaml
#   docker run --rm -v "$PWD:/data" kinpole report recording.mcap --output report.html

FROM ros:jazzy-ros-base AS ros
RUN apt-get update && apt-get install --yes --no-install-recommends \
      gcc libc6-dev python3-venv \
      ros-jazzy-common-interfaces ros-jazzy-launch-ros ros-jazzy-tf2-msgs \
    && rm -rf /var/lib/apt/lists/*
COPY . /src
# The packages of that ROS are those of the system's Python.
RUN python3 -m venv --system-site-packages /opt/kinpole \
    && /opt/kinpole/bin/pip install --no-cache-dir '/src[plot]' \
    && rm -rf /src
ENV PATH="/opt/kinpole/bin:$PATH"
WORKDIR /data
# The entry point of the base image sources ROS.
ENTRYPOINT ["/ros_entrypoint.sh", "kinpole"]
CMD ["--help"]

FROM python:3.12-slim AS wheels
RUN apt-get update && apt-get install --yes --no-install-recommends gcc libc6-dev
RUN python3 -m venv /opt/kinpole
COPY requirements/demo.txt /src/requirements/demo.txt
RUN /opt/kinpole/bin/pip install --no-cache-dir --require-hashes --no-deps \
      --requirement /src/requirements/demo.txt
COPY . /src
RUN /opt/kinpole/bin/pip install --no-cache-dir --no-deps --no-build-isolation /src

FROM python:3.12-slim AS python
COPY --from=wheels /opt/kinpole /opt/kinpole
ENV PATH="/opt/kinpole/bin:$PATH"
WORKDIR /data
ENTRYPOINT ["kinpole"]
CMD ["--help"]
