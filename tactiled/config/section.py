"""What every table of the configuration file has in common."""

from pydantic import BaseModel, ConfigDict


class Section(BaseModel):
    """A table of the file: refuses a key that it does not know. The text below a key describes it in the guide."""

    model_config = ConfigDict(extra="forbid", frozen=True, use_attribute_docstrings=True)
