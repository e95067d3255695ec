//! A spinner on standard error for work that takes longer than a second, and nothing where nobody watches.

use std::io::IsTerminal;
use std::sync::mpsc::{self, RecvTimeoutError, Sender};
use std::thread::JoinHandle;
use std::time::Duration;

use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};

use crate::options::Common;

/// Shows what is being done until it is dropped.
pub(crate) struct Progress {
    shown: Option<(Sender<String>, JoinHandle<()>)>,
}

impl Progress {
    /// Starts with a first step.
    pub(crate) fn start(common: &Common, step: impl Into<String>) -> Self {
        if common.quiet || !std::io::stderr().is_terminal() {
            return Self { shown: None };
        }
        let (sender, steps) = mpsc::channel::<String>();
        let mut step = step.into();
        let watch = move || {
            loop {
                match steps.recv_timeout(Duration::from_secs(1)) {
                    Ok(next) => step = next,
                    Err(RecvTimeoutError::Timeout) => break,
                    Err(RecvTimeoutError::Disconnected) => return,
                }
            }
            let style = ProgressStyle::with_template("{spinner} {msg} ({elapsed})");
            let bar = ProgressBar::with_draw_target(None, ProgressDrawTarget::stderr())
                .with_style(style.unwrap_or_else(|_| ProgressStyle::default_spinner()))
                .with_message(step);
            bar.enable_steady_tick(Duration::from_millis(120));
            while let Ok(next) = steps.recv() {
                bar.set_message(next);
            }
            bar.finish_and_clear();
        };
        Self { shown: Some((sender, std::thread::spawn(watch))) }
    }

    /// Goes on to the next step.
    pub(crate) fn step(&self, step: impl Into<String>) {
        if let Some((sender, _)) = &self.shown {
            // A watcher that is gone has nothing left to show.
            let _ = sender.send(step.into());
        }
    }
}

impl Drop for Progress {
    fn drop(&mut self) {
        if let Some((sender, watcher)) = self.shown.take() {
            drop(sender);
            let _ = watcher.join();
        }
    }
}

/// A bar on standard error for work whose steps can be counted, and nothing where nobody watches.
pub(crate) struct CountBar {
    shown: Option<ProgressBar>,
}

impl CountBar {
    /// Starts at none of `total` steps, called `unit`.
    pub(crate) fn start(common: &Common, total: u64, unit: &str) -> Self {
        if common.quiet || !std::io::stderr().is_terminal() {
            return Self { shown: None };
        }
        let template = format!("{{bar:40}} {{pos}}/{{len}} {unit}, {{msg}} ({{elapsed}}, {{eta}} left)");
        let style = ProgressStyle::with_template(&template).unwrap_or_else(|_| ProgressStyle::default_bar());
        let bar = ProgressBar::with_draw_target(Some(total), ProgressDrawTarget::stderr()).with_style(style);
        Self { shown: Some(bar) }
    }

    /// Shows how many steps are done, and a few words.
    pub(crate) fn show(&self, done: u64, words: &str) {
        if let Some(bar) = &self.shown {
            bar.set_message(words.to_owned());
            bar.set_position(done);
        }
    }

    /// Says something above the bar, or alone where there is none.
    pub(crate) fn note(&self, text: Option<String>) {
        match (&self.shown, text) {
            (Some(bar), Some(text)) => bar.println(text),
            (None, Some(text)) => eprintln!("{text}"),
            (_, None) => {}
        }
    }
}

impl Drop for CountBar {
    fn drop(&mut self) {
        if let Some(bar) = &self.shown {
            bar.finish_and_clear();
        }
    }
}
