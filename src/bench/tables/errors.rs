//! How wrong answers are: the paper's two measures.

use crate::visibility::{LightPoint, Receiver, light_words};
use rayon::prelude::*;

/// Wrong answers about pairs of a receiver and a light.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Errors {
    /// Receivers.
    pub receivers: u64,
    /// Pairs.
    pub pairs: u64,
    /// Pairs that are hidden in truth.
    pub hidden: u64,
    /// Pairs said to be hidden that are not.
    pub wrongly_hidden: u64,
    /// Pairs said to be visible that are not.
    pub wrongly_visible: u64,
    /// Pairs whose light is on the side that the receiver faces: the others are hidden by their own surface.
    pub facing: u64,
    /// Wrong ones of these.
    pub facing_wrong: u64,
    /// Sum over the receivers of |wrongly visible − wrongly hidden|.
    shadow: u64,
}

impl Errors {
    /// Compares found bits with true ones, both as [`Visibility::hidden_lights`](crate::visibility::Visibility) gives
    /// them.
    ///
    /// # Panics
    /// If the lengths do not fit.
    pub fn compare(truth: &[u32], found: &[u32], receivers: &[Receiver], lights: &[LightPoint]) -> Self {
        let words = light_words(lights.len());
        assert_eq!(truth.len(), found.len(), "the same receivers and lights");
        assert_eq!(truth.len(), receivers.len() * words, "one bit for each receiver and light");
        let words = words.max(1);
        let of_receiver = |((truth, found), receiver): ((&[u32], &[u32]), &Receiver)| {
            let mut one = Self { receivers: 1, pairs: lights.len() as u64, ..Self::default() };
            for (index, (&truth, &found)) in truth.iter().zip(found).enumerate() {
                let lights = &lights[index * 32..lights.len().min(index * 32 + 32)];
                let facing = lights
                    .iter()
                    .enumerate()
                    .fold(0u32, |mask, (bit, light)| mask | u32::from(!light.is_behind(receiver)) << bit);
                one.hidden += u64::from(truth.count_ones());
                one.wrongly_hidden += u64::from((found & !truth).count_ones());
                one.wrongly_visible += u64::from((truth & !found).count_ones());
                one.facing += u64::from(facing.count_ones());
                one.facing_wrong += u64::from(((truth ^ found) & facing).count_ones());
            }
            one.shadow = one.wrongly_visible.abs_diff(one.wrongly_hidden);
            one
        };
        truth
            .par_chunks(words)
            .zip(found.par_chunks(words))
            .zip(receivers)
            .map(of_receiver)
            .reduce(Self::default, Self::plus)
    }

    fn plus(self, other: Self) -> Self {
        Self {
            receivers: self.receivers + other.receivers,
            pairs: self.pairs + other.pairs,
            hidden: self.hidden + other.hidden,
            wrongly_hidden: self.wrongly_hidden + other.wrongly_hidden,
            wrongly_visible: self.wrongly_visible + other.wrongly_visible,
            facing: self.facing + other.facing,
            facing_wrong: self.facing_wrong + other.facing_wrong,
            shadow: self.shadow + other.shadow,
        }
    }

    /// \[WMP\]'s visibility error: the share of pairs with a wrong answer, per cent.
    pub fn eps_v(&self) -> f64 {
        percent(self.wrongly_hidden + self.wrongly_visible, self.pairs)
    }

    /// \[WMP\]'s shadow error: |wrongly visible − wrongly hidden| / lights, averaged over the receivers, per cent.
    pub fn eps_s(&self) -> f64 {
        percent(self.shadow, self.pairs)
    }

    /// The visibility error among lights that the receiver faces, per cent.
    pub fn eps_v_facing(&self) -> f64 {
        percent(self.facing_wrong, self.facing)
    }

    /// Pairs that are hidden in truth, per cent.
    pub fn hidden_share(&self) -> f64 {
        percent(self.hidden, self.pairs)
    }
}

fn percent(part: u64, whole: u64) -> f64 {
    if whole == 0 { 0.0 } else { 100.0 * part as f64 / whole as f64 }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn errors_of_one_receiver_may_cancel_and_those_of_two_do_not() {
        let receivers = [Receiver { position: [0.0; 3], normal: [0.0, 1.0, 0.0] }; 2];
        let lights: Vec<_> =
            (0..40).map(|i| LightPoint::at([0.0, if i < 10 { 1.0 } else { -1.0 }, 0.0])).collect();
        let truth = [0b0011, 0, 0, 0b1000_0000];
        let found = [0b0101, 0, 0b1000, 0b1100_0000];
        let errors = Errors::compare(&truth, &found, &receivers, &lights);
        assert_eq!((errors.receivers, errors.pairs, errors.hidden), (2, 80, 3));
        assert_eq!((errors.wrongly_hidden, errors.wrongly_visible), (3, 1));
        assert_eq!((errors.eps_v(), errors.eps_s()), (5.0, 2.5));
        assert_eq!((errors.facing, errors.facing_wrong), (20, 3));
        assert_eq!(Errors::compare(&[], &[], &[], &lights), Errors::default());
        assert_eq!(Errors::default().eps_v(), 0.0);
    }
}
