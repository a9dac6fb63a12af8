"""Expressions of KRL, RAPID and URScript: a tokeniser, a parser, and values.

One grammar serves the three: or, and, not, comparison, sum, product, sign, call or name. What differs are
words (AND, and), signs (==, =, <>, !=) and the brackets of records; the readers give them in one form.
"""

import operator
import re
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from scanmotion.core.errors import PlanFileError

_TOKEN = re.compile(
    r"\s*(?:(?P<num>\d+\.?\d*(?:[eE][-+]?\d+)?)|(?P<str>\"[^\"]*\")|(?P<name>[#$A-Za-z_][\w$]*)"
    r"|(?P<op>==|<>|!=|<=|>=|:=|[-+*/<>=(){}\[\],.\\]))"
)
_SAME = {"=": "==", "<>": "!="}
MOST_DEEP = 50


@dataclass(frozen=True, kw_only=True)
class Name:
    """A variable: its word, indices in brackets, fields after dots."""

    word: str
    index: Any = None
    field: str = ""


Evaluate = Callable[[Name], Any]
"""Value of a variable."""
Call = Callable[[str, list[Any]], Any]
"""Value of a function."""


def tokens_of(text: str) -> list[tuple[str, str]]:
    """Kind and text of each token.

    Raises:
        PlanFileError: a character that no expression has.
    """
    found, at = [], 0
    text = text.strip()
    while at < len(text):
        match = _TOKEN.match(text, at)
        if match is None:
            raise PlanFileError(f"{text[:60]!r}: {text[at : at + 10]!r} is not understood")
        kind = str(match.lastgroup)
        found.append((kind, match[kind]))
        at = match.end()
    return found


class Parser:
    """Recursive descent over tokens; gives nested tuples ("num", 1.0), ("op", "+", a, b), Name, ..."""

    def __init__(self, text: str) -> None:
        self.text, self.tokens, self.at, self.deep = text, tokens_of(text), 0, 0

    def whole(self) -> Any:
        """The one expression that the text is.

        Raises:
            PlanFileError: it is none, or more follows.
        """
        found = self.either()
        if self.at < len(self.tokens):
            self.fail()
        return found

    def fail(self) -> None:
        """Says where the text is not understood."""
        raise PlanFileError(f"{self.text.strip()[:80]!r} is not understood")

    def peek(self) -> str:
        return self.tokens[self.at][1] if self.at < len(self.tokens) else ""

    def take(self, *words: str) -> str:
        """The next token where it is one of these words, else nothing."""
        if self.at < len(self.tokens) and self.tokens[self.at][0] != "str" and self.peek().upper() in words:
            self.at += 1
            return self.tokens[self.at - 1][1].upper()
        return ""

    def need(self, word: str) -> None:
        """Takes a token that has to be there."""
        if not self.take(word):
            self.fail()

    def either(self) -> Any:
        """A OR b."""
        self.deep += 1
        if self.deep > MOST_DEEP:
            self.fail()
        left = self.both()
        while self.take("OR"):
            left = ("or", left, self.both())
        self.deep -= 1
        return left

    def both(self) -> Any:
        left = self.negated()
        while self.take("AND"):
            left = ("and", left, self.negated())
        return left

    def negated(self) -> Any:
        if self.take("NOT"):
            return ("not", self.negated())
        left = self.total()
        sign = self.take("==", "=", "<>", "!=", "<=", ">=", "<", ">")
        return ("op", _SAME.get(sign, sign), left, self.total()) if sign else left

    def total(self) -> Any:
        left = self.product()
        while sign := self.take("+", "-"):
            left = ("op", sign, left, self.product())
        return left

    def product(self) -> Any:
        left = self.one()
        while sign := self.take("*", "/"):
            left = ("op", sign, left, self.one())
        return left

    def one(self) -> Any:
        if self.take("-"):
            return ("neg", self.one())
        if self.at >= len(self.tokens):
            self.fail()
        kind, text = self.tokens[self.at]
        self.at += 1
        if kind == "num":
            return ("num", float(text))
        if kind == "str":
            return ("str", text[1:-1])
        if text == "(":
            inner = self.either()
            self.need(")")
            return inner
        if text == "{":
            return self.record()
        if text == "[":
            return ("list", self.items("]"))
        if kind != "name":
            self.fail()
        if text.upper() in ("TRUE", "FALSE"):
            return ("bool", text.upper() == "TRUE")
        return self.named(text)

    def named(self, word: str) -> Any:
        """A variable or a call."""
        if self.take("("):
            return ("call", word.upper(), self.items(")"))
        index, field = None, ""
        if self.take("["):
            if self.take("]"):
                return Name(word=word.upper())
            index = self.either()
            self.need("]")
        while self.take("."):
            field += ("." if field else "") + self.peek().upper()
            self.at += 1
        return Name(word=word.upper(), index=index, field=field)

    def items(self, end: str) -> list[Any]:
        """Values to the closing bracket."""
        found: list[Any] = []
        if self.take(end):
            return found
        while True:
            found.append(self.either())
            if self.take(end):
                return found
            self.need(",")

    def record(self) -> Any:
        """{A1 1.0,A2 2.0}: values by name; a name that stands twice is an error."""
        found: dict[str, Any] = {}
        while True:
            key = self.peek().upper()
            self.at += 1
            if self.take("["):
                self.need("]")
            if not re.fullmatch(r"[A-Z]\w*", key) or key in found:
                self.fail()
            found[key] = self.either()
            if self.take("}"):
                return ("record", found)
            self.need(",")


def value_of(node: Any, of: Evaluate, call: Call) -> Any:
    """Value of a parsed expression.

    Raises:
        PlanFileError: it has none.
    """
    if isinstance(node, Name):
        return of(node)
    kind = node[0]
    if kind == "op":
        return _operated(node[1], value_of(node[2], of, call), value_of(node[3], of, call))
    if kind in ("num", "str", "bool"):
        return node[1]
    if kind == "record":
        return {k: value_of(v, of, call) for k, v in node[1].items()}
    if kind == "list":
        return [value_of(v, of, call) for v in node[1]]
    if kind == "call":
        return call(node[1], [value_of(v, of, call) for v in node[2]])
    if kind == "or":
        return bool(value_of(node[1], of, call)) or bool(value_of(node[2], of, call))
    if kind == "and":
        return bool(value_of(node[1], of, call)) and bool(value_of(node[2], of, call))
    if kind == "not":
        return not value_of(node[1], of, call)
    return -value_of(node[1], of, call)


_SIGNS = {
    "==": operator.eq, "!=": operator.ne, "<=": operator.le, ">=": operator.ge, "<": operator.lt,
    ">": operator.gt, "+": operator.add, "-": operator.sub, "*": operator.mul, "/": operator.truediv,
}  # fmt: skip


def _operated(sign: str, a: Any, b: Any) -> Any:
    try:
        return _SIGNS[sign](a, b)
    except (TypeError, ZeroDivisionError):
        raise PlanFileError(f"{str(a)[:30]} {sign} {str(b)[:30]} has no value") from None


_FIELDS = {"ROBAX": 0, "EXTAX": 1, "EAX_A": 0, **{f"RAX_{i}": i - 1 for i in range(1, 7)}}


def member(value: Any, field: str) -> Any:
    """A component of a record: KRL's by name, RAPID's by place."""
    for word in field.split("."):
        value = value[word] if isinstance(value, dict) else value[_FIELDS[word]]
    return value
