//! Pages that people read: one HTML file with everything in it, pictures included.
//!
//! Parts are text; [`document`] puts them together.

use base64::Engine as _;
use base64::engine::general_purpose::STANDARD;

use crate::text::html;

const STYLE: &str = "\
body{font:16px/1.5 system-ui,sans-serif;color:#20242c;max-width:1180px;margin:0 auto;padding:24px}\
h1{font-size:30px;margin:0 0 4px}h2{font-size:23px;margin:48px 0 8px;border-top:1px solid #d0d3d8;padding-top:24px}\
p.about{color:#555b66;max-width:900px}figure{margin:18px 0}figure img,figure svg{max-width:100%;height:auto;display:block}\
figcaption,caption{color:#555b66;font-size:14px;text-align:left;padding:6px 0;max-width:900px;caption-side:bottom}\
table{border-collapse:collapse;font-size:14px;margin:18px 0}div.wide{overflow-x:auto}\
th,td{padding:4px 10px;text-align:right;border-bottom:1px solid #e6e8ec;vertical-align:top}\
th{background:#f4f5f7;white-space:nowrap}td:first-child,th:first-child,table.text td,table.text th{text-align:left}\
code{background:#f4f5f7;padding:1px 4px}\
@media print{body{max-width:none;padding:0;font-size:11pt}h2{margin-top:18pt;break-after:avoid}figure,tr{break-inside:avoid}\
div.wide{overflow:visible}}@page{margin:16mm}";

/// A whole page: `title` is text, `style` more CSS, `body` HTML.
#[must_use]
pub fn document(title: &str, style: &str, body: &str) -> String {
    format!(
        "<!DOCTYPE html>\n<html lang=\"en\"><head><meta charset=\"utf-8\"><meta name=\"viewport\" content=\"width=device-width\">\
         <title>{}</title><style>{STYLE}{style}</style></head><body>\n{body}</body></html>\n",
        html(title)
    )
}

/// A picture, the bytes of a PNG file, with its caption.
#[must_use]
pub fn picture(png: &[u8], caption: &str) -> String {
    let (data, caption) = (STANDARD.encode(png), html(caption));
    format!(
        "<figure><img alt=\"{caption}\" src=\"data:image/png;base64,{data}\"><figcaption>{caption}</figcaption></figure>\n"
    )
}

/// A table of text with `caption`, HTML, below it.
#[must_use]
pub fn table(caption: &str, header: &[impl AsRef<str>], rows: impl IntoIterator<Item = Vec<String>>) -> String {
    let line = |tag: &str, cells: &mut dyn Iterator<Item = &str>| -> String {
        let cells: String = cells.map(|cell| format!("<{tag}>{}</{tag}>", html(cell))).collect();
        format!("<tr>{cells}</tr>\n")
    };
    let head = line("th", &mut header.iter().map(AsRef::as_ref));
    let rows: String = rows.into_iter().map(|row| line("td", &mut row.iter().map(String::as_str))).collect();
    format!("<div class=\"wide\"><table><caption>{caption}</caption>{head}{rows}</table></div>\n")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn text_stays_text() {
        assert_eq!(html("<b> & \"c\""), "&lt;b&gt; &amp; &quot;c&quot;");
        let table = table("<i>c</i>", &["x<y"], [vec!["1 & 2".to_owned()]]);
        assert!(
            table.contains("<i>c</i>") && table.contains("<th>x&lt;y</th>") && table.contains("<td>1 &amp; 2</td>")
        );
    }

    #[test]
    fn a_page_holds_its_pictures() {
        let page = document("a & b", "p{}", &picture(&[0, 255, 16], "a \"nose\""));
        assert!(page.contains("<title>a &amp; b</title>") && page.contains("p{}</style>"));
        assert!(page.contains("base64,AP8Q\"") && page.contains("alt=\"a &quot;nose&quot;\""));
    }
}
