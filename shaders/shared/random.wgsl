// Counter-based random numbers, with the integer operations of crates/base/src/random.rs, so that
// both give the same bits.

const STREAM_CONTORTION: u32 = 2u;
const STREAM_GROWTH: u32 = 3u;

fn pcg4d_round(v: vec4<u32>) -> vec4<u32> {
    var w = v;
    w.x += w.y * w.w;
    w.y += w.z * w.x;
    w.z += w.x * w.y;
    w.w += w.y * w.z;
    return w;
}

fn pcg4d(v: vec4<u32>) -> vec4<u32> {
    var w = pcg4d_round(v * 1664525u + vec4<u32>(1013904223u));
    w ^= w >> vec4<u32>(16u);
    return pcg4d_round(w);
}

// Four random words for (seed, stream, a, b).
fn random_words(seed: vec2<u32>, stream: u32, a: u32, b: u32) -> vec4<u32> {
    let high = (seed.y * 0x9E3779B9u) ^ (stream * 0x85EBCA6Bu);
    return pcg4d(vec4<u32>(seed.x, high, a, b));
}

// Maps a word to [0, 1), with 24 bits.
fn random_unit(word: u32) -> f32 {
    return f32(word >> 8u) * (1.0 / 16777216.0);
}

// Maps a word to 0..n; n is at most 65,536.
fn random_below(word: u32, n: u32) -> u32 {
    return ((word >> 16u) * n) >> 16u;
}
