# vapor-track in a container, for processors: `docker build --tag vapor-track .`, then
# `docker run --rm --volume "$PWD:/data" vapor-track run walk.mcap --model place.safetensors --output result`.
# docs/install.md says how to give pip the index of torch's CPU builds: without it the image has libraries for GPUs, too.
FROM python:3.13-slim AS build
ENV PIP_NO_CACHE_DIR=1
WORKDIR /source
COPY . .
RUN pip install --quiet "build>=1.2" && python -m build --wheel --outdir /wheel .

FROM python:3.13-slim
ARG PIP_EXTRA_INDEX_URL
ENV PIP_NO_CACHE_DIR=1
COPY --from=build /wheel /wheel
COPY .ci/install /wheel/install
RUN /wheel/install /opt/vapor-track /wheel/*.whl && useradd --create-home vapor
ENV PATH=/opt/vapor-track/bin:$PATH
USER vapor
WORKDIR /data
ENTRYPOINT ["vapor-track"]
CMD ["--help"]
