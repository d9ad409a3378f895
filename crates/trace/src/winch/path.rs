//! The path of one axis in f64, once a millisecond.
//!
//! Source: seeds/003, `Path::pollForInterval`, at a fixed 1 kHz, with docs/winch.md's ramp, impulse and stop. Written for the
//! judge: it shares nothing with the boards' fixed point (`pulsetrain_core::winch::path`).

use super::command::{Command, Order};

/// A millisecond, s.
const DT: f64 = 1e-3;

/// Four axes and their drivers. While these are off the paths stand still.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Board {
    pub(super) paths: [Path; 4],
    /// The drivers are on.
    pub(super) drives: bool,
    /// The drivers are to be off as soon as no axis moves.
    is_releasing: bool,
}

impl Board {
    pub(super) const START: Board = Board { paths: [Path::START; 4], drives: false, is_releasing: false };

    pub(super) fn obey(&mut self, command: &Command) {
        for (path, order) in self.paths.iter_mut().zip(command.orders) {
            let Some(order) = order else { continue };
            path.obey(order);
            match order {
                Order::Stop => self.is_releasing = self.drives,
                Order::Gains { .. } | Order::Limits { .. } => {}
                _ => self.is_releasing = false,
            }
        }
        if command.enables {
            (self.drives, self.is_releasing) = (true, false);
        }
    }

    /// One millisecond.
    pub(super) fn tick(&mut self) {
        if self.drives {
            self.paths.iter_mut().for_each(Path::tick);
        }
        if self.is_releasing && self.paths.iter().all(|path| path.speed.abs() < 1.0) {
            (self.drives, self.is_releasing) = (false, false);
        }
    }

    /// All that it is, to tell two of them apart.
    pub(super) fn bits(&self) -> ([[u64; 11]; 4], [bool; 2]) {
        let bits = |path: &Path| {
            let Path { position, speed, reference, target, drift, ramp, .. } = *path;
            let Path { stiffness, damping, max_speed, max_acceleration, is_stopping, .. } = *path;
            let numbers =
                [position, speed, reference, target, drift, ramp, stiffness, damping, max_speed, max_acceleration];
            let mut bits = [u64::from(is_stopping); 11];
            for (place, number) in bits.iter_mut().zip(numbers) {
                *place = number.to_bits();
            }
            bits
        };
        (self.paths.each_ref().map(bits), [self.drives, self.is_releasing])
    }

    /// How fast an axis goes in this millisecond, steps/s.
    pub(super) fn speed(&self, axis: usize) -> f64 {
        if self.drives { self.paths[axis].speed } else { 0.0 }
    }
}

/// Where an axis is, and where it is to go; steps and seconds.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Path {
    pub(super) position: f64,
    pub(super) speed: f64,
    reference: f64,
    target: f64,
    drift: f64,
    /// Fastest that the reference goes to its target; 0: at once.
    ramp: f64,
    stiffness: f64,
    damping: f64,
    max_speed: f64,
    max_acceleration: f64,
    is_stopping: bool,
}

impl Path {
    /// As a board begins: 1 Hz, b = 1 (it rings), 3500 steps/s, 35 000 steps/s².
    pub(super) const START: Path = Path {
        position: 0.0,
        speed: 0.0,
        reference: 0.0,
        target: 0.0,
        drift: 0.0,
        ramp: 0.0,
        stiffness: std::f64::consts::TAU * std::f64::consts::TAU,
        damping: 1.0,
        max_speed: 3500.0,
        max_acceleration: 35e3,
        is_stopping: false,
    };

    fn obey(&mut self, order: Order) {
        // Whoever is stopping has its target where it is.
        if self.is_stopping {
            (self.target, self.reference) = (self.position, self.position);
        }
        match order {
            Order::Gains { frequency_hz, ratio } => {
                let omega = std::f64::consts::TAU * frequency_hz;
                (self.stiffness, self.damping) = (omega * omega, 2.0 * ratio * omega);
                return;
            }
            Order::Limits { speed, acceleration } => {
                (self.max_speed, self.max_acceleration) = (speed, acceleration);
                return;
            }
            Order::Target(steps) => self.target = steps,
            Order::Move(steps) => self.target += steps,
            Order::Drift(speed) => self.drift = speed,
            Order::Impulse(steps) => {
                self.target += steps;
                self.reference += steps;
            }
            Order::Ramp(speed) => self.ramp = speed,
            Order::Stop => {
                self.drift = 0.0;
                self.is_stopping = true;
                return;
            }
        }
        self.is_stopping = false;
        if self.ramp == 0.0 {
            self.reference = self.target;
        }
    }

    /// One millisecond: the position goes on by the speed that it had.
    fn tick(&mut self) {
        if self.ramp > 0.0 {
            let most = self.ramp * DT;
            self.reference += (self.target - self.reference).clamp(-most, most);
        }
        let wanted = if self.is_stopping {
            -self.speed / DT
        } else {
            self.stiffness * (self.reference - self.position) + self.damping * (self.drift - self.speed)
        };
        let acceleration = wanted.clamp(-self.max_acceleration, self.max_acceleration);
        self.position += self.speed * DT;
        // A speed above a new limit goes down within amax, not at once.
        let fastest = self.max_speed.max(self.speed.abs() - self.max_acceleration * DT);
        self.speed = (self.speed + acceleration * DT).clamp(-fastest, fastest);
        self.reference += self.drift * DT;
        self.target += self.drift * DT;
        if self.is_stopping && self.speed.abs() < 1e-9 {
            self.speed = 0.0;
            self.is_stopping = false;
            (self.target, self.reference) = (self.position, self.position);
        }
    }
}
