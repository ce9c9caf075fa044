//! The drive while it looks for the motor's electrical zero (see [`crate::alignment`]).

use super::Drive;
use crate::alignment::{Alignment, Reason, Step};
use crate::fault::Fault;
use crate::position::Position;
use crate::profile::Profile;

/// What is known of the electrical zero.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Commutation {
    /// Nothing: there is no offset for this encoder, or the encoder is one that does not know where it is.
    Unknown,
    /// Nothing: the last alignment failed.
    Failed(Reason),
    /// What the parameters say.
    Stored,
    /// What the last alignment found: the position of electrical angle 0.
    Found(Position),
}

impl Commutation {
    /// There is an electrical zero to commutate by.
    pub fn is_known(self) -> bool {
        matches!(self, Commutation::Stored | Commutation::Found(_))
    }
}

impl Drive {
    /// What is known of the motor's electrical zero.
    pub fn commutation(&self) -> Commutation {
        self.commutation
    }

    /// One tick of an alignment: the vector to put out, an end, or the fault of a failure.
    pub(super) fn align(&mut self, iq_a: f32) -> Option<Fault> {
        let alignment = self.aligning.as_mut().filter(|_| self.torque)?;
        let position = self.tracker.position();
        // The loops are open: wherever the stage is, there it is to be.
        self.profile = Profile::at_rest(position);
        self.reference = self.profile.advance();
        match alignment.step(&self.config.alignment, position, iq_a) {
            Step::Hold { turns, amps } => {
                // The q axis leads the angle of the frame by a quarter of a turn.
                self.vector = Some([if turns < 0.25 { turns + 0.75 } else { turns - 0.25 }, amps]);
                None
            }
            Step::Found { at, turns } => {
                let past_zero_ct = (turns * self.config.turn_ct as f32) as i64;
                let zero = at.plus(-past_zero_ct);
                self.config.commutation_zero = zero;
                self.begin_angle();
                self.commutation = Commutation::Found(zero);
                self.end_alignment();
                None
            }
            Step::Refused(reason) => {
                self.commutation = Commutation::Failed(reason);
                self.end_alignment();
                Some(Fault::Alignment)
            }
        }
    }

    /// Begins at the present position, if that is what the loops have been closed for.
    pub(super) fn begin_alignment(&mut self, position: Position) {
        if self.aligning.is_some() {
            self.commutation = Commutation::Unknown;
            self.aligning = Some(Alignment::start(position));
        }
    }

    /// Bridge off, whatever it has come to.
    pub(super) fn end_alignment(&mut self) {
        self.aligning = None;
        self.vector = None;
        self.drop_request();
    }

    /// The electrical angle is computed anew from the next position on.
    pub(super) fn begin_angle(&mut self) {
        self.electrical_ct = 0;
        self.electrical_at = self.config.commutation_zero;
    }
}
