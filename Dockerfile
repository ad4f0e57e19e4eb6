# syntax=docker/dockerfile:1
# Builds the service and copies only its binary into a small image:
#   docker build -t oviduct .
#   docker run --rm -p 127.0.0.1:8080:8080 -v oviduct:/data oviduct

FROM rust:1.95-slim-bookworm AS build
RUN apt-get update \
 && apt-get install -y --no-install-recommends build-essential \
 && rm -rf /var/lib/apt/lists/*
WORKDIR /source
COPY . .
RUN --mount=type=cache,target=/usr/local/cargo/registry \
    --mount=type=cache,target=/source/target \
    cargo build --locked --release --bin oviduct \
 && cp target/release/oviduct /oviduct \
 && mkdir /data

# glibc, libgcc, libstdc++ and an unprivileged user: no shell, no package manager.
FROM gcr.io/distroless/cc-debian12:nonroot
COPY --from=build /oviduct /usr/local/bin/oviduct
COPY --from=build --chown=nonroot:nonroot /data /data
USER nonroot
WORKDIR /data
VOLUME /data
EXPOSE 8080
# A container has its own loopback, so the service must listen on all addresses to be reachable from outside. Without keys
# it then makes a first admin key and prints it (docs/access.md); OVIDUCT_INSECURE_NO_AUTH=true serves anyone instead.
ENV OVIDUCT_ADDR=0.0.0.0:8080 \
    OVIDUCT_DATA=/data \
    OVIDUCT_LOG_FORMAT=json
# The time until SIGKILL (docker stop --time) must exceed --grace, so that running jobs are released to the queue.
STOPSIGNAL SIGTERM
# Requests http://127.0.0.1:8080/healthz in the container; if OVIDUCT_ADDR has another port, set OVIDUCT_URL too.
HEALTHCHECK --interval=10s --timeout=5s --start-period=10s --retries=3 \
    CMD ["/usr/local/bin/oviduct", "healthcheck"]
ENTRYPOINT ["/usr/local/bin/oviduct"]
CMD ["serve"]
