//! Tests of the HTTP API: the router in process, over a real job store and real files.

#![expect(clippy::unwrap_used, reason = "a test fails by it")]

mod api {
    mod access;
    mod app;
    mod bad_input;
    mod batches;
    mod bodies;
    mod browser;
    mod bulk;
    mod course;
    mod create;
    mod crowd;
    mod cut;
    mod damaged;
    mod events;
    mod examples;
    mod faulty;
    mod files;
    mod fits;
    mod greedy;
    mod models;
    mod narrow;
    mod net;
    mod obstacles;
    mod operators;
    mod packs;
    mod prefix;
    mod preview;
    mod replays;
    mod report;
    mod rfc;
    mod sections;
    mod service;
    mod shares;
    mod slides;
    mod studies;
    mod waiting;
    mod way;
    mod wire;
}
