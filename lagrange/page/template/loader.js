// Unpacks the scripts and the numbers of a recording, and starts the player. Both are compressed, as text in base64.

const inflated = async (text) => {
    const bytes = Uint8Array.from(atob(text), (mark) => mark.charCodeAt(0));
    return new Response(new Blob([bytes]).stream().pipeThrough(new DecompressionStream("deflate"))).arrayBuffer();
};

(async () => {
    const [scripts, numbers] = document.getElementById("packed").textContent.split(" ");
    const script = document.createElement("script");
    script.textContent = new TextDecoder().decode(await inflated(scripts));
    document.body.append(script);
    startRecording(new Uint8Array(await inflated(numbers)));
})();
