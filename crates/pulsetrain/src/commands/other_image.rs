//! An Uno runs another of its images than a command needs. At a terminal the user may let this program write the right
//! one.

use miette::Report;
use pulsetrain_board::remote::image_name;
use pulsetrain_board::{BoardKind, Remote, Serial};

use super::flash;
use super::problems::OtherImage;
use crate::console::Console;
use pulsetrain_session::drive::session_number;

/// The error for the Uno at a port, if it answers and runs another image than `wanted`.
pub(crate) fn image_at(port: &str, wanted: &'static str) -> Option<OtherImage> {
    let remote = Remote::open_if_free(Serial::open(port, false).ok()?, session_number()).ok()?;
    let (kind, image) = (remote.kind(), remote.info().image);
    remote.close();
    let is = image_name(image);
    let has_images = kind.is_some_and(BoardKind::has_image_for_each_role);
    (has_images && is != wanted).then_some(OtherImage { is, wanted })
}

/// If a command was refused because of the board's image: asks the user at the terminal, and writes the right image to
/// the board at `port`. `None` if the command was refused for another reason, if there is no terminal, or if the user
/// says no.
pub(crate) fn offered(refused: &Report, port: Option<&str>, console: &mut Console<'_>) -> Option<miette::Result<()>> {
    let (other, port) = (refused.downcast_ref::<OtherImage>()?, port?);
    wanted(other, port, |question| console.confirm(question)).then(|| flash::write(port, other.image(), console))
}

/// Whether the user wants the image written.
fn wanted(other: &OtherImage, port: &str, ask: impl FnOnce(&str) -> Option<bool>) -> bool {
    let question = format!("At {port}, {other}. This would write it, and then begin again: `{}`", other.command(port));
    ask(&question) == Some(true)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_question_names_board_port_and_command() {
        for (is, wants, command) in [
            ("winch", "uno", "`pulsetrain flash uno --port COM3`"),
            ("uno", "verbs", "`pulsetrain flash uno --port COM3 --image verbs`"),
        ] {
            let other = OtherImage { is, wanted: wants };
            let mut asked = String::new();
            for (answer, is_wanted) in [(Some(true), true), (Some(false), false), (None, false)] {
                let said = wanted(&other, "COM3", |question| {
                    asked = question.to_owned();
                    answer
                });
                assert_eq!(said, is_wanted, "{answer:?}");
            }
            assert!(asked.contains(&format!("the image `{is}`")) && asked.contains(command), "{asked}");
        }
    }

    #[test]
    fn nothing_is_offered_where_nobody_can_be_asked_or_nothing_would_help() {
        let (mut out, mut err) = (Vec::new(), Vec::new());
        let mut console = Console::new(&mut out, &mut err, false);
        let other = Report::from(OtherImage { is: "winch", wanted: "uno" });
        assert!(offered(&other, Some("COM3"), &mut console).is_none());
        assert!(offered(&other, None, &mut console).is_none());
        assert!(offered(&miette::miette!("no space"), Some("COM3"), &mut console).is_none());
        assert!(out.is_empty() && err.is_empty());
    }
}
