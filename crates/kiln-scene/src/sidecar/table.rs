//! Typed and located access to parsed TOML, so that every error names its line.

use super::{SidecarText, nearest};
use crate::SceneError;
use glam::DVec3;
use toml::{
    Spanned,
    de::{DeTable, DeValue},
};

/// The most samples per face that a rule may set.
const MOST_SAMPLES: u32 = 65_536;

/// Parses the text.
pub(super) fn parse(source: SidecarText<'_>) -> Result<Spanned<DeTable<'_>>, SceneError> {
    DeTable::parse(source.text).map_err(|error| SceneError::Sidecar {
        file: source.name.to_owned(),
        line: line_of(source.text, error.span().map_or(0, |span| span.start)),
        problem: format!("it is not valid TOML: {}", error.message()),
        advice: "correct it".to_owned(),
    })
}

fn line_of(text: &str, byte: usize) -> usize {
    1 + text.bytes().take(byte).filter(|byte| *byte == b'\n').count()
}

/// A table of the sidecar.
pub(super) struct Table<'t> {
    source: SidecarText<'t>,
    table: &'t DeTable<'t>,
    start: usize,
}

/// A value of the sidecar, with its key.
pub(super) struct Entry<'t> {
    source: SidecarText<'t>,
    key: &'t str,
    value: &'t Spanned<DeValue<'t>>,
}

impl<'t> Table<'t> {
    pub(super) fn root(source: SidecarText<'t>, table: &'t Spanned<DeTable<'t>>) -> Self {
        Self { source, table: table.get_ref(), start: 0 }
    }

    /// Refuses keys that are neither known nor of a later feature, and names those that are of one.
    pub(super) fn check_keys(&self, known: &[&str], later: &[&str]) -> Result<(), SceneError> {
        for key in self.table.keys() {
            let name: &str = key.get_ref();
            if known.contains(&name) {
                continue;
            }
            let (problem, advice) = if later.contains(&name) {
                (format!("{name} is not supported yet"), "remove it until it is".to_owned())
            } else {
                (format!("there is no key {name}"), format!("did you mean {}?", nearest(name, known)))
            };
            return Err(error(self.source, key.span().start, problem, &advice));
        }
        Ok(())
    }

    pub(super) fn get(&self, key: &'t str) -> Option<Entry<'t>> {
        self.table.get(key).map(|value| Entry { source: self.source, key, value })
    }

    pub(super) fn require(&self, key: &'t str) -> Result<Entry<'t>, SceneError> {
        self.get(key).ok_or_else(|| error(self.source, self.start, format!("{key} is missing"), "add it"))
    }
}

impl<'t> Entry<'t> {
    /// An error at this entry.
    pub(super) fn error(&self, problem: impl Into<String>, advice: &str) -> SceneError {
        error(self.source, self.value.span().start, problem.into(), advice)
    }

    fn expected(&self, what: &str) -> SceneError {
        let found = self.value.get_ref().type_str();
        self.error(format!("{} is a TOML {found}", self.key), &format!("give {what}"))
    }

    pub(super) fn string(&self) -> Result<&'t str, SceneError> {
        self.value.get_ref().as_str().ok_or_else(|| self.expected("a string"))
    }

    pub(super) fn boolean(&self) -> Result<bool, SceneError> {
        self.value.get_ref().as_bool().ok_or_else(|| self.expected("true or false"))
    }

    pub(super) fn number_within(&self, least: f64, most: f64) -> Result<f64, SceneError> {
        let number = number(self.value.get_ref()).ok_or_else(|| self.expected("a number"))?;
        if number >= least && number <= most {
            return Ok(number);
        }
        let range = if most == f64::MAX { format!("at least {least}") } else { format!("between {least} and {most}") };
        Err(self.error(format!("{} is {number}", self.key), &format!("give a number {range}")))
    }

    /// A number of samples per face, made even.
    pub(super) fn samples(&self) -> Result<u32, SceneError> {
        let integer = self.value.get_ref().as_integer();
        let samples = integer.and_then(|integer| u32::from_str_radix(integer.as_str(), integer.radix()).ok());
        let samples = samples.filter(|samples| (1..=MOST_SAMPLES).contains(samples));
        let advice = "give a whole number from 1 to 65,536";
        samples
            .map(|samples| samples.next_multiple_of(2))
            .ok_or_else(|| self.error(format!("{} is not a number of samples", self.key), advice))
    }

    /// A whole number in a range, its ends included.
    pub(super) fn whole_within(&self, least: u32, most: u32) -> Result<u32, SceneError> {
        let whole = self.value.get_ref().as_integer();
        let whole = whole.and_then(|integer| u32::from_str_radix(integer.as_str(), integer.radix()).ok());
        whole.filter(|whole| (least..=most).contains(whole)).ok_or_else(|| {
            let advice = format!("give a whole number from {least} to {most}");
            self.error(format!("{} is not such a number", self.key), &advice)
        })
    }

    /// A point, or another three finite numbers no farther from 0 than `most`.
    pub(super) fn point(&self, most: f64) -> Result<DVec3, SceneError> {
        let numbers = self.numbers()?;
        let &[x, y, z] = numbers.as_slice() else {
            return Err(self.error(format!("{} has {} numbers", self.key, numbers.len()), "give three numbers, metres"));
        };
        // Not for NaN either.
        if [x, y, z].iter().all(|number| number.abs() <= most) {
            return Ok(DVec3::new(x, y, z));
        }
        let advice = format!("give finite metres, from -{most} to {most}");
        Err(self.error(format!("{} is [{x}, {y}, {z}]", self.key), &advice))
    }

    pub(super) fn numbers(&self) -> Result<Vec<f64>, SceneError> {
        let array = self.value.get_ref().as_array().ok_or_else(|| self.expected("an array of numbers"))?;
        array.iter().map(|v| number(v.get_ref()).ok_or_else(|| self.expected("an array of numbers"))).collect()
    }

    pub(super) fn strings(&self) -> Result<Vec<&'t str>, SceneError> {
        let array = self.value.get_ref().as_array().ok_or_else(|| self.expected("an array of strings"))?;
        array.iter().map(|v| v.get_ref().as_str().ok_or_else(|| self.expected("an array of strings"))).collect()
    }

    pub(super) fn table(&self, written: &str) -> Result<Table<'t>, SceneError> {
        let table = self.value.get_ref().as_table().ok_or_else(|| self.expected(&format!("a table {written}")))?;
        Ok(Table { source: self.source, table, start: self.value.span().start })
    }

    pub(super) fn tables(&self, written: &str) -> Result<Vec<Table<'t>>, SceneError> {
        let expected = || self.expected(&format!("tables, each headed {written}"));
        let array = self.value.get_ref().as_array().ok_or_else(expected)?;
        let one = |value: &'t Spanned<DeValue<'t>>| Entry { source: self.source, key: self.key, value }.table(written);
        array.iter().map(one).collect()
    }
}

fn number(value: &DeValue<'_>) -> Option<f64> {
    match value {
        DeValue::Float(float) => float.as_str().parse().ok(),
        DeValue::Integer(integer) => i64::from_str_radix(integer.as_str(), integer.radix()).ok().map(|i| i as f64),
        _ => None,
    }
}

fn error(source: SidecarText<'_>, byte: usize, problem: String, advice: &str) -> SceneError {
    SceneError::Sidecar {
        file: source.name.to_owned(),
        line: line_of(source.text, byte),
        problem,
        advice: advice.to_owned(),
    }
}
