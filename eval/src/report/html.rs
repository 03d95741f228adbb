//! `report.html`: one page that needs nothing beside it. What a person in a hurry wants stands first.
use super::{Built, Gallery, gallery::base64};
use maud::{DOCTYPE, Markup, PreEscaped, html};

/// Tables that stand in the first part; the others are folded away further down.
const FIRST: [&str; 9] = ["headline", "table6", "sweeps", "expected", "min-side", "compare-1", "pose", "pose-shares", "summary"];

impl Built {
    /// The page.
    #[must_use]
    pub fn html(&self) -> String {
        let (first, rest): (Vec<_>, Vec<_>) = self.tables.iter().partition(|t| FIRST.contains(&t.key.as_str()));
        let page = html! {
            (DOCTYPE)
            html lang="en" {
                head {
                    meta charset="utf-8";
                    meta name="viewport" content="width=device-width, initial-scale=1";
                    title { (self.title) }
                    style { (PreEscaped(include_str!("style.css"))) }
                }
                body {
                    header {
                        h1 { (self.title) }
                        @for verdict in &self.verdicts { p class="verdict" { (verdict) } }
                    }
                    div class="first" { @for table in &first { (PreEscaped(table.table.html())) } }
                    @if !self.problems.is_empty() {
                        aside {
                            h2 { "Faults in the files, counted and not hidden" }
                            ul { @for problem in &self.problems { li { (problem) } } }
                        }
                    }
                    section {
                        h2 { "Figures" }
                        div class="figures" {
                            @for figure in &self.figures {
                                figure { figcaption { (figure.title) } (PreEscaped(figure.canvas.svg())) }
                            }
                        }
                    }
                    @for gallery in &self.galleries { (pictures(gallery)) }
                    @for extra in &self.extras {
                        section {
                            h2 { (extra.title) }
                            div class="figures" { @for fragment in &extra.fragments { figure { (PreEscaped(fragment)) } } }
                        }
                    }
                    section {
                        h2 { "Tables" }
                        @for table in &rest {
                            details open[table.key == "thresholds" || table.key == "coco"] {
                                summary { (table.table.caption) }
                                (PreEscaped(table.table.html()))
                            }
                        }
                    }
                    @if !self.provenance.is_empty() {
                        section {
                            h2 { "How this was made" }
                            table class="provenance" {
                                @for (key, value) in &self.provenance {
                                    tr { th { (key) } td { @if value.contains('\n') { pre { (value) } } @else { (value) } } }
                                }
                            }
                        }
                    }
                }
            }
        };
        page.into_string()
    }
}

fn pictures(gallery: &Gallery) -> Markup {
    html! {
        section {
            h2 { (gallery.title) }
            p class="note" {
                (gallery.pictures.len()) " of " (gallery.of) ". Box: "
                span class="true" { "true" } ", " span class="claimed" { "detected" } "."
            }
            div class="gallery" {
                @for picture in &gallery.pictures {
                    figure {
                        img src={ "data:image/jpeg;base64," (base64(&picture.jpeg)) } width=(picture.width) height=(picture.height)
                            alt=(picture.caption) loading="lazy";
                        figcaption { (picture.caption) }
                    }
                }
            }
        }
    }
}
