# Shortcuts; `just` lists them.

default:
    @just --list

# Everything that CI runs
check:
    scripts/test

# The same without tests/outside
quick:
    scripts/test quick

# Fuzz what reads requests and files, 20 s a target
fuzz:
    scripts/fuzz

# Grow a pig's oviduct, save it to ./demo, and exit
demo:
    cargo run --release -- demo --exit

# Generate openapi.yaml from the code
openapi:
    cargo run --quiet -- openapi > openapi.yaml
