"""What tests share: cases, references and scenes."""
