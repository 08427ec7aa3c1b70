"""One file a skin: its settings, its layout both ways, what `sniff` looks for. Every file here is a codec."""
