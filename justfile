# Shortcuts; `just` lists them.

default:
    @just --list

# Everything that CI runs
check:
    scripts/test

# The same without the judges of others
quick:
    scripts/test quick

# Grow a pig's oviduct, save it to ./demo, end
demo:
    cargo run --release -- demo --exit

# Write openapi.yaml anew from the code
openapi:
    cargo run --quiet -- openapi > openapi.yaml
