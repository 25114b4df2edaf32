# docker build -t gainroom . && docker run --rm -v "$PWD:/work" gainroom audit robot.xml --delay-ms 1.5 --rate-hz 2000
FROM python:3.13 AS build
COPY . /source
RUN pip wheel --no-cache-dir --no-deps --wheel-dir /wheels /source

FROM python:3.13-slim
RUN --mount=type=bind,from=build,source=/wheels,target=/wheels \
    pip install --no-cache-dir "$(echo /wheels/*.whl)[app,robot]" && useradd --create-home --uid 1000 user
USER 1000
WORKDIR /work
ENTRYPOINT ["gainroom"]
CMD ["--help"]
