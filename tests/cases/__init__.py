"""Small inputs that once gave a wrong answer without a warning; each is a test with the right value."""
