"""`python -m tests.docs`: print every generated block of README and guide again."""

from tests.docs.blocks import pages, printed

for path in pages():
    before = path.read_text("utf-8")
    if (after := printed(before)) != before:
        path.write_text(after, "utf-8")
        print(path)
