// Decompress the style sheet, the scripts and the numbers of a recording, and start the player. All are in base64.

const inflated = async (text) => {
    const bytes = Uint8Array.from(atob(text), (mark) => mark.charCodeAt(0));
    return new Response(new Blob([bytes]).stream().pipeThrough(new DecompressionStream("deflate"))).arrayBuffer();
};

(async () => {
    const [style, scripts, numbers] = document.getElementById("packed").textContent.split(" ");
    for (const [name, text] of [["style", style], ["script", scripts]]) {
        const element = document.createElement(name);
        element.textContent = new TextDecoder().decode(await inflated(text));
        document.head.append(element);
    }
    startRecording(new Uint8Array(await inflated(numbers)));
})();
