//! Readers of numbers, choices, lists and schedules from JSON. Every fault is recorded.

use super::bounds::{Count, Range, out_of};
use super::canonical::number;
use super::fault::{child, describe};
use super::reader::{JsonReader, Site};
use super::schedule::{Ease, Fluctuation, Schedule};
use super::table::{Kind, Parameter};
use serde_json::{Value, json};

/// Maximum number of keys of a schedule.
pub(super) const MAX_KEYS: usize = 256;
/// Bounds of the period of a fluctuation, in steps. Sampling once per step cannot resolve periods
/// below two steps.
pub(super) const PERIOD: Range = Range::of(2.0, 1e6);
/// Maximum number of points of a list.
pub(super) const MAX_POINTS: usize = 1000;
/// Maximum number of rows of a grid.
pub(super) const MAX_GRID: usize = 129;
const MEMBERS: [&str; 3] = ["keys", "ease", "fluctuation"];

impl JsonReader {
    fn keys(&mut self, site: Site<'_>, value: &Value, range: Range) -> Option<Vec<[f64; 2]>> {
        let at = child(site.at, "keys");
        let Some(items) = value.as_array() else {
            return self.unexpected(at, "an array of [fraction, value] pairs", value);
        };
        if items.is_empty() {
            return self.fault(at, "has no keys; give at least [0, value] and [1, value]");
        }
        if items.len() > MAX_KEYS {
            return self.fault(at, format!("has {} keys; at most {MAX_KEYS} are allowed", items.len()));
        }
        let keys: Vec<Option<[f64; 2]>> = (0..).zip(items).map(|(i, key)| self.key(site, &at, i, key, range)).collect();
        let fractions: Vec<Option<f64>> =
            items.iter().map(|key| key.get(0).and_then(Value::as_f64).filter(|u| (0.0..=1.0).contains(u))).collect();
        let before = self.count();
        if let Some(u) = fractions[0].filter(|u| *u != 0.0) {
            self.fault::<()>(format!("{at}/0/0"), format!("is {u}; the first key must be at 0"));
        }
        let last = items.len() - 1;
        if let Some(u) = fractions[last].filter(|u| *u != 1.0) {
            self.fault::<()>(format!("{at}/{last}/0"), format!("is {u}; the last key must be at 1"));
        }
        for (i, pair) in fractions.windows(2).enumerate() {
            if let [Some(a), Some(b)] = pair
                && b <= a
            {
                let detail = format!("is {b}, not above {a} of the key before it; keys must be in order");
                self.fault::<()>(format!("{at}/{}/0", i + 1), detail);
            }
        }
        if self.count() > before { None } else { keys.into_iter().collect() }
    }

    fn key(&mut self, site: Site<'_>, keys: &str, i: usize, key: &Value, range: Range) -> Option<[f64; 2]> {
        let at = format!("{keys}/{i}");
        let Some([u, v]) = key.as_array().map(Vec::as_slice) else {
            let got = key.as_array().map_or_else(|| describe(key), |a| format!("an array of {}", a.len()));
            return self.fault(at, format!("must be a pair [fraction, value], not {got}"));
        };
        let (at_u, at_v) = (format!("{at}/0"), format!("{at}/1"));
        let u = f64::read(self, Site { at: &at_u, unit: "of the steps" }, u, Range::of(0.0, 1.0));
        let v = f64::read(self, Site { at: &at_v, unit: site.unit }, v, range);
        Some([u?, v?])
    }

    fn point<const N: usize>(&mut self, site: Site<'_>, i: usize, value: &Value, range: Range) -> Option<[f64; N]> {
        let at = format!("{}/{i}", site.at);
        let Some(values) = value.as_array().filter(|values| values.len() == N) else {
            let got = value.as_array().map_or_else(|| describe(value), |a| format!("an array of {}", a.len()));
            return self.fault(at, format!("must be a point [{}], not {got}", coordinates(N)));
        };
        self.numbers(Site { at: &at, unit: site.unit }, values, range)?.try_into().ok()
    }

    fn numbers(&mut self, site: Site<'_>, values: &[Value], range: Range) -> Option<Vec<f64>> {
        let mut read = |(i, value): (usize, &Value)| {
            let at = format!("{}/{i}", site.at);
            f64::read(self, Site { at: &at, unit: site.unit }, value, range)
        };
        let numbers: Vec<Option<f64>> = values.iter().enumerate().map(&mut read).collect();
        numbers.into_iter().collect()
    }

    fn fluctuation(&mut self, site: Site<'_>, value: &Value) -> Option<Option<Fluctuation>> {
        let at = child(site.at, "fluctuation");
        let Some(members) = value.as_object() else {
            return self.unexpected(at, "an object with \"amplitude\" and \"period\"", value);
        };
        let known = self.only(&at, members, &["amplitude", "period"]);
        let at_amplitude = child(&at, "amplitude");
        let amplitude = match members.get("amplitude") {
            None => self.fault(&at_amplitude, "is missing"),
            Some(value) => {
                f64::read(self, Site { at: &at_amplitude, unit: site.unit }, value, Range::of(0.0, f64::MAX))
            }
        };
        let at_period = child(&at, "period");
        let period = match members.get("period") {
            // Amplitude 0 removes the fluctuation, which needs no period.
            None if amplitude == Some(0.0) => Some(PERIOD.min),
            None => self.fault(&at_period, "is missing"),
            Some(value) => f64::read(self, Site { at: &at_period, unit: "steps" }, value, PERIOD),
        };
        let fluctuation = Fluctuation { amplitude: amplitude?, period: period? };
        known.then_some((fluctuation.amplitude != 0.0).then_some(fluctuation))
    }
}

/// Names of the coordinates of a point, for messages.
fn coordinates(count: usize) -> &'static str {
    match count {
        2 => "x, y",
        3 => "x, y, z",
        _ => "at, turn_deg, toward_deg, share",
    }
}

impl Parameter for f64 {
    type Rule = Range;

    fn kind(rule: Range) -> Kind {
        Kind::Number(rule)
    }

    fn read(reader: &mut JsonReader, site: Site<'_>, value: &Value, rule: Range) -> Option<Self> {
        let v = reader.number(site.at, value)?;
        reader.bounded(site, v, rule)
    }

    fn write(&self) -> Value {
        number(*self)
    }
}

impl Parameter for u32 {
    type Rule = Count;

    fn kind(rule: Count) -> Kind {
        Kind::Integer(rule)
    }

    fn read(reader: &mut JsonReader, site: Site<'_>, value: &Value, rule: Count) -> Option<Self> {
        let v = reader.number(site.at, value)?;
        if v.fract() != 0.0 {
            return reader.fault(site.at, format!("is {v}; it must be an integer"));
        }
        let v = reader.bounded(site, v, Range::of(f64::from(rule.min), f64::from(rule.max)))?;
        Some(v as u32)
    }

    fn write(&self) -> Value {
        Value::from(*self)
    }
}

impl Parameter for bool {
    type Rule = ();

    fn kind((): ()) -> Kind {
        Kind::Bool
    }

    fn read(reader: &mut JsonReader, site: Site<'_>, value: &Value, (): ()) -> Option<Self> {
        reader.flag(site.at, value)
    }

    fn write(&self) -> Value {
        Value::from(*self)
    }
}

impl<const N: usize> Parameter for Vec<[f64; N]> {
    type Rule = Range;

    fn kind(rule: Range) -> Kind {
        Kind::Points(N, rule)
    }

    fn read(reader: &mut JsonReader, site: Site<'_>, value: &Value, rule: Range) -> Option<Self> {
        let Some(items) = value.as_array() else {
            return reader.unexpected(site.at, format_args!("an array of points [{}]", coordinates(N)), value);
        };
        if items.len() > MAX_POINTS {
            return reader.fault(site.at, format!("has {} points; at most {MAX_POINTS} are allowed", items.len()));
        }
        let points: Vec<Option<[f64; N]>> =
            (0..).zip(items).map(|(i, item)| reader.point(site, i, item, rule)).collect();
        points.into_iter().collect()
    }

    fn write(&self) -> Value {
        self.iter().map(|point| point.map(number).to_vec()).collect()
    }
}

impl Parameter for Vec<Vec<f64>> {
    type Rule = Range;

    fn kind(rule: Range) -> Kind {
        Kind::Grid(rule)
    }

    fn read(reader: &mut JsonReader, site: Site<'_>, value: &Value, rule: Range) -> Option<Self> {
        let Some(rows) = value.as_array() else {
            return reader.unexpected(site.at, "an array of rows of numbers", value);
        };
        if rows.len() > MAX_GRID || rows.len() == 1 {
            return reader.fault(site.at, format!("has {} rows; 0 or 2 to {MAX_GRID} are allowed", rows.len()));
        }
        let mut row = |(i, value): (usize, &Value)| {
            let at = format!("{}/{i}", site.at);
            match value.as_array().filter(|values| values.len() == rows.len()) {
                Some(values) => reader.numbers(Site { at: &at, unit: site.unit }, values, rule),
                None => {
                    reader.fault(at, format!("must be an array of {} numbers: as many as there are rows", rows.len()))
                }
            }
        };
        let rows: Vec<Option<Vec<f64>>> = rows.iter().enumerate().map(&mut row).collect();
        rows.into_iter().collect()
    }

    fn write(&self) -> Value {
        self.iter().map(|row| row.iter().copied().map(number).collect::<Value>()).collect()
    }
}

impl Parameter for Schedule {
    type Rule = Range;

    fn kind(rule: Range) -> Kind {
        Kind::Schedule(rule)
    }

    fn read(reader: &mut JsonReader, site: Site<'_>, value: &Value, rule: Range) -> Option<Self> {
        if let Some(v) = value.as_f64() {
            return reader.bounded(site, v + 0.0, rule).map(Self::constant);
        }
        let Some(members) = value.as_object() else {
            return reader.unexpected(site.at, "a number or an object with \"keys\"", value);
        };
        let known = reader.only(site.at, members, &MEMBERS);
        let keys = match members.get("keys") {
            Some(value) => reader.keys(site, value, rule),
            None => reader.fault(child(site.at, "keys"), "is missing"),
        };
        let ease = match members.get("ease") {
            Some(value) => {
                let at = child(site.at, "ease");
                Ease::read(reader, Site { at: &at, unit: "" }, value, ())
            }
            None => Some(Ease::Linear),
        };
        let fluctuation = match members.get("fluctuation") {
            Some(value) => reader.fluctuation(site, value),
            None => Some(None),
        };
        let schedule = Self::new(keys?, ease?, fluctuation?);
        if rule.steady && schedule.fluctuation.is_some() {
            return reader.fault(child(site.at, "fluctuation"), "must not fluctuate: it must never decrease");
        }
        let (low, high) = schedule.range();
        if let Some(detail) = out_of(low, rule, site.unit).or_else(|| out_of(high, rule, site.unit)) {
            // The keys are within bounds, so the fluctuation exceeds them.
            let at = format!("{}/fluctuation/amplitude", site.at);
            return reader.fault(at, format!("makes the value leave its bounds: it {detail}"));
        }
        known.then_some(schedule)
    }

    fn write(&self) -> Value {
        let constant = (self.keys.len() == 1).then(|| self.keys[0][1]);
        if let (Some(v), None) = (constant, self.fluctuation) {
            return number(v);
        }
        let keys: Vec<Value> = match constant {
            Some(v) => [0.0, 1.0].map(|u| json!([number(u), number(v)])).to_vec(),
            None => self.keys.iter().map(|[u, v]| json!([number(*u), number(*v)])).collect(),
        };
        // Written even if absent: as a patch, amplitude 0 removes a fluctuation of the preset.
        let fluctuation = match self.fluctuation {
            Some(f) => json!({ "amplitude": number(f.amplitude), "period": number(f.period) }),
            None => json!({ "amplitude": 0 }),
        };
        json!({ "keys": keys, "ease": self.ease.name(), "fluctuation": fluctuation })
    }
}
