# Shortcuts; `just` lists them

default:
    @just --list

# Run everything that CI runs
check:
    scripts/test

# Run everything except tests/outside
quick:
    scripts/test quick

# Fuzz the readers of requests and files, 20 s per target
fuzz:
    scripts/fuzz

# Grow a pig's oviduct, save it to ./demo, and exit
demo:
    cargo run --release -- demo --exit

# Generate openapi.yaml from the code
openapi:
    cargo run --quiet -- openapi > openapi.yaml
