use oviduct::sim::cpu::*;
use oviduct::sim::*;
use oviduct::spec::*;
fn main() {
    let a: Vec<String> = std::env::args().collect();
    let seed: u64 = a[1].parse().unwrap();
    let search = match a[2].as_str() {
        "lists" => Search::Lists,
        "grid" => Search::Grid,
        _ => Search::AllPairs,
    };
    let threads: usize = a[3].parse().unwrap();
    let steps: u32 = a[4].parse().unwrap();
    let pig = a.get(5).map(|s| s == "pig").unwrap_or(true);
    let out = a.get(6);
    let env = |k: &str, d: f64| std::env::var(k).ok().and_then(|v| v.parse().ok()).unwrap_or(d);
    let c = Schedule::constant;
    let sm = |a: f64, b: f64| Schedule::keyed(vec![[0.0, a], [0.125, a], [0.45, b], [1.0, b]], Ease::Smooth);
    let p = Parameters {
        length_mm: 60.0,
        steps,
        burn_in: 300 * steps / 2000,
        z: Schedule::keyed(vec![[0.0, 0.0], [0.2125, 0.35], [1.0, 1.0]], Ease::Linear),
        particles: Particles {
            total: Schedule::keyed(vec![[0.0, 710.0], [0.2125, 1175.0], [1.0, 8300.0]], Ease::Linear),
            outer: Schedule::keyed(vec![[0.0, 110.0], [1.0, 300.0]], Ease::Linear),
            every: 10,
            edge_um: c(8.0),
            tip_weight: c(env("TIP", if pig { 1.0 } else { 0.0 })),
            candidates: env("CAND", if pig { 6.0 } else { 3.0 }) as u32,
        },
        spring: Spring { stiffness: c(0.5), damping: c(0.1), relaxation: c(0.02) },
        friction: c(0.3),
        bending: c(env("BEND", 0.15)),
        containment: Containment {
            strength: c(2.0),
            ramp_um: c(15.0),
            squash: c(0.88),
            spacing_um: sm(env("S0", 115.0), 62.0),
            wall_um: sm(520.0, 260.0),
        },
        regulatory: Regulatory { strength: c(env("REG", 0.035)), softening_um: c(15.0) },
        contortion: Contortion { fraction: 0.04, magnitude: c(env("CONT", 1.0)), period: 120.0 },
        collision: Collision {
            strength: c(0.3),
            tissue_um: sm(env("DT0", 180.0), env("DT", 80.0)),
            gap_um: sm(45.0, if pig { 26.0 } else { 30.0 }),
            reference_um: 55.0,
            barrier: c(3.0),
            barrier_um: c(5.0),
            clearance_um: 0.05,
        },
        variation: Variation {
            amplitude: c(if pig { env("VAR", 0.35) } else { 0.0 }),
            wavelength_um: 300.0,
            drift: 0.01,
        },
        wall: Wall { lobing: c(0.04), lobes: 5, drift: 0.004 },
        solver: Solver { integrator: Integrator::Rk4, search, record_every: 10 },
        mesh: MeshOptions { strips: false },
    };
    let t = std::time::Instant::now();
    let mut sim = CpuSimulation::new(Plan::new(&p, seed), threads);
    eprintln!("plan {:?}", t.elapsed());
    let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
    let mut h = 0xcbf29ce484222325u64;
    pool.install(|| {
        while sim.time() < steps as i64 {
            if let Err(e) = sim.step() {
                eprintln!("{e}");
                break;
            }
            let tm = sim.time();
            if tm >= 0 && tm % 10 == 0 {
                let s = sim.section();
                for q in s.inner.points.iter().chain(&s.outer.points) {
                    for v in q {
                        h = (h ^ v.to_bits() as u64).wrapping_mul(0x100000001b3);
                    }
                }
                if let Some(o) = out {
                    if [0, 200, 420, 425, 800, 1200, 1600, 2000].contains(&(tm * 2000 / steps as i64)) {
                        let f = |r: &oviduct::model::Ring| {
                            r.points.iter().map(|p| format!("{} {}", p[0], p[1])).collect::<Vec<_>>().join("\n")
                        };
                        std::fs::write(format!("{o}/inner{tm:04}.txt"), f(&s.inner)).unwrap();
                        std::fs::write(format!("{o}/outer{tm:04}.txt"), f(&s.outer)).unwrap();
                    }
                }
            }
        }
    });
    println!("{:?} n={} hash={h:x} {:?}", t.elapsed(), sim.particles(), sim.statistics());
}
