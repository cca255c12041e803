//! The window on a bench that does nothing but write down what it is asked: every panel and state, every key.

#[path = "viewer/colors.rs"]
mod colors;
#[path = "viewer/fake.rs"]
mod fake;
#[path = "viewer/habits.rs"]
mod habits;
#[path = "viewer/images.rs"]
mod images;
#[path = "viewer/registration.rs"]
mod registration;
#[path = "viewer/replaying.rs"]
mod replaying;
#[path = "viewer/settings.rs"]
mod settings;
#[path = "viewer/states.rs"]
mod states;
#[path = "viewer/tools.rs"]
mod tools;
