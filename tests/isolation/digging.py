"""Work in pure Python, for processes of aiorts and others. It imports nothing."""


def dig(turns: int) -> int:
    """Turn a number over so many times."""
    value = 1
    for _ in range(turns):
        value = (value * 1_103_515_245 + 12_345) & 0x7FFFFFFF
    return value
