# The one software stack: the same lock and set-up script as on any other machine.
FROM python:3.11-slim-bookworm

WORKDIR /headcap
RUN apt-get update \
    && apt-get install -y --no-install-recommends ca-certificates git libegl1 libgl1 libgomp1 libusb-1.0-0 make \
    && rm -rf /var/lib/apt/lists/*

COPY requirements.lock pyproject.toml README.md LICENSE Makefile ./
COPY .ci .ci
COPY src src
COPY pipeline pipeline
ENV PYTHON=python3
RUN .ci/setup .venv && touch .venv/.setup-done
ENV PATH="/headcap/.venv/bin:$PATH"

COPY Snakefile ./
COPY rules rules
COPY profiles profiles
COPY config config

# recordings are mounted at /data, results leave through /headcap/results
ENTRYPOINT ["headcap"]
CMD ["run", "config/demo.yaml"]
