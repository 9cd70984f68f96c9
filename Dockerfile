# leadline on a companion computer: x86-64 and arm64, and a BlueOS extension.
#
#   docker buildx build --platform linux/amd64,linux/arm64 --tag you/leadline:0.1.0 --push .
#   docker run --rm --network host --privileged --volume /data:/data you/leadline:0.1.0 doctor
#
# Every wheel it needs exists for both; nothing is compiled and nothing is fetched when it runs.
FROM python:3.11-slim AS build
COPY constraints.txt pyproject.toml README.md LICENSE /source/
COPY src /source/src
RUN python -m venv /opt/leadline \
 && /opt/leadline/bin/pip install --no-cache-dir --constraint /source/constraints.txt "/source[live,mavlink]"

FROM python:3.11-slim
# libglib2 and libusb: what OpenCV's camera and film readers link to
RUN apt-get update && apt-get install --yes --no-install-recommends libglib2.0-0 libusb-1.0-0 v4l-utils \
 && rm -rf /var/lib/apt/lists/*
COPY --from=build /opt/leadline /opt/leadline
COPY deploy/start.sh /usr/local/bin/leadline-start
ENV PATH=/opt/leadline/bin:$PATH PYTHONUNBUFFERED=1 LEADLINE_PAGE=0.0.0.0:8550
WORKDIR /data
VOLUME /data
EXPOSE 8550/tcp

LABEL version="0.1.0"
LABEL type="device-integration"
LABEL requirements="core >= 1.1"
LABEL tags='["navigation", "camera", "positioning", "laser"]'
LABEL authors='[{"name": "the leadline project", "email": ""}]'
LABEL company='{"name": "leadline", "about": "Where is the target?", "email": ""}'
LABEL readme="https://raw.githubusercontent.com/leadline/leadline/{tag}/docs/vehicle.md"
LABEL links='{"source": "https://github.com/leadline/leadline"}'
# Host network: MAVLink and ROS 2 find their peers; privileged with /dev: cameras and serial lines come and go.
LABEL permissions='{"ExposedPorts": {"8550/tcp": {}}, "NetworkMode": "host", "HostConfig": {"Privileged": true, "NetworkMode": "host", "Binds": ["/usr/blueos/extensions/leadline:/data", "/dev:/dev"]}}'

ENTRYPOINT ["leadline-start"]
